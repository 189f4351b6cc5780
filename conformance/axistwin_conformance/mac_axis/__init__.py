"""The axis of the MAC modules, whichever way they are talked to: motion, parameters, acceptance,
stops, faults, and the checks and probes of all that.

A face (`mac_serial`, `mac_can`) brings the way to talk (`talk.Talk`), its bench, and what differs:
frames and identifiers, names of requirements, commands of its own.  Nothing here imports a face.
Requirements are named as in the serial ledger, whose motion chapter is the common one; a family
with another ledger says there which of its own they are (`covers`).
"""
