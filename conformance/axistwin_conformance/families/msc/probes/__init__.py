"""The quirk probes of the MSC."""
