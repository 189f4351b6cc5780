"""``can.Bus(interface="axistwin", channel="mac23-can:1,2")``: twins behind a python-can interface.

``channel="MODEL[:ADDRESS][,[MODEL:]ADDRESS...][?PARAMETER=VALUE[&...]]"``; the parameters may also
be keyword arguments of ``can.Bus``.

======================= ======================================================================
``time=virtual``        time passes only while the host waits
``time=real``           the default; ``time=20``: twenty times as fast
``bitrate=125000``      of the bus, bits per second
``quirk.NAME=VALUE``    a reading that the manual leaves open; as an argument ``quirks={...}``
``profile=FILE``        a file with a set of quirks, or the name of one that comes with a model
``state=DIR``           keep what a real unit keeps; as an argument ``state_dir=DIR``
``seed=N``              the seed of everything random
``pacing=no``           frames take no time on the bus
``cold=yes``            switch the devices on now: they boot first
``host_clock=yes``      the program's ``time.sleep`` and clocks move virtual time too
``bus=NAME``            a bus of this name, the same for all who open it
======================= ======================================================================

Rules
-----
1. Bus objects of this process with the same devices in their channel (or the same ``bus=NAME``)
   share one bus.  It ends, its memory saved, when the last of them is shut down.
2. In virtual time, time passes in ``recv`` and ``advance``, and in ``send`` while its queue is
   full.  ``recv(0)`` that finds nothing takes as long as the shortest frame, so that polling ends.
   Periodic tasks are due at their exact times, whichever port lets time pass.
3. Time stamps are seconds: since the beginning in virtual time, else since the epoch.
4. A port is a controller of its own: it acknowledges, it competes, and it can go bus-off.
"""

from axistwin.canbus.interface import AxistwinBus

__all__ = ["AxistwinBus"]
