"""Sweeps over devices that nobody made by hand: twins of drawn readings, twins wrong in one thing.

What is here knows the ledgers and the twins, and none of the suite's checks.
"""
