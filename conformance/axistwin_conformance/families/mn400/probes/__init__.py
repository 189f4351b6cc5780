"""Probes of the MN400: which reading of its manual a board follows."""
