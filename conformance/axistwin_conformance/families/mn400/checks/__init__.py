"""Checks of the MN400."""
