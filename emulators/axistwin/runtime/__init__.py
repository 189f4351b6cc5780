"""Shells: clocks, storage, and the one place that performs effects."""
