"""The MN400, a 4-axis step and direction controller, on its serial line.

`codec` builds packets, sound or not, and takes them apart; `grammar` knows the 40 commands and what
their parameters may be; `words` puts packets into words; `lenient` names what is wrong with a
reply.  `boundaries` and `model.draws` make texts, `safety` tells what they may do to a board.
`planner` says how axes move, `model` what a board must answer, `motion` bounds and watches it.
`client` sends one request and takes its reply; `driver` is what checks and probes hold; `snapshot`
has the acts of the engine.
"""
