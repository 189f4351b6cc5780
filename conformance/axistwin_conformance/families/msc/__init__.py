"""MSC motion system controllers behind their executive port: packets, a data area, 256 flags, and a
status word.

`codec` builds packets, sound or not, and takes them apart; `client` sends one request and takes its
reply; `driver` is what checks and probes hold, with `link` and `scratch` as its parts; `family` is
what the engine must know.  The folders hold the checks, the probes, the sequences with their model,
and what is looked at before any check.
"""
