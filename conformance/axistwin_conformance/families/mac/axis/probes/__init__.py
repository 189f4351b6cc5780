"""The quirk probes of the axis, whichever face it has."""
