"""The quirk probes of the serial face alone."""
