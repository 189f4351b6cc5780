"""What checks are sorted by: what they may do to a device, and how much is run."""

SAFETY_CLASSES = ("passive", "motion", "stored", "rig", "destructive")  # in the order they run
LEVELS = ("quick", "full", "soak")
FULL, SOAK = LEVELS[1:]  # full: what is run unless the user says otherwise
