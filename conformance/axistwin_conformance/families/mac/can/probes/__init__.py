"""The quirk probes of the CAN face alone."""
