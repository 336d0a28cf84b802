"""How good a rig is: against the truth (``pose``), and on images that the calibration has not seen (``image``)."""
