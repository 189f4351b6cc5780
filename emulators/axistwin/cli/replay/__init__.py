"""Recordings of a line or bus, and twins that are told the same."""
