"""MSC motion system controllers behind their executive port: packets, a data area, 256 flags, and a
status word.

`codec` builds packets, sound or not, and takes them apart; `talk` is one unit on the line; `bench`
is what checks take into their hands; `family` is what the engine must know.  The other modules hold
the model, the sequences, the checks and the probes.
"""
