"""The host program's own time, moved together with its twins."""
