"""The MSC family: motion system controllers with an executive port (packets, flags, variables)."""
