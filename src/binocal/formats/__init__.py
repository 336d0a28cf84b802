"""Files to and from calibrations; every foreign convention is converted here."""
