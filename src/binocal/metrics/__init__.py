"""How good a rig is: against the truth (``pose``), and on pictures that the calibration has not seen (``image``)."""
