"""Time is an integer number of nanoseconds since the world was switched on.

There is one kind of time below the shells: ``Nanos``.  Nothing here reads a clock; whoever drives
the world passes the time in.  A MAC tick (0.125 µs) is 125 ns, so motion is exact in it.
"""

from typing import TypeAlias

Nanos: TypeAlias = int

NS_PER_US: Nanos = 1_000
NS_PER_MS: Nanos = 1_000_000
NS_PER_S: Nanos = 1_000_000_000
