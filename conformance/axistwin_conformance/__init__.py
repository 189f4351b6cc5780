"""Judges motion controllers, real ones and twins alike, against their manuals.

The suite is written from the requirement ledger alone.  It shares no code and no tables with the
twins; the two meet on the wire.
"""
