"""The host-side driver of one axis."""
