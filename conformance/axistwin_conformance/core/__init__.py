"""What a check is handed and what a family is: session, profile, probes, `Family`."""
