"""What checks are sorted by: what they may do to a device, and how much is run."""

# In the order they run.  negative: writes that a sound device must not carry out.
SAFETY_CLASSES = ("passive", "motion", "stored", "negative", "rig", "destructive")
LEVELS = ("quick", "full", "soak")
FULL, SOAK = LEVELS[1:]  # full: what is run unless the user says otherwise
