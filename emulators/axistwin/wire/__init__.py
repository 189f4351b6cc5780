"""Wires: what happens to bytes between two stations.  Pure state machines, told the time."""
