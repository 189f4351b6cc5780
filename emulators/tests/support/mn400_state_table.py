"""The table of commands and states (ledger §4.1), cell by cell, apart from the twin's own."""

COLUMNS = "RDY MOV QUE PAU HLD HPD CCB CCX PRG CFG RUN JOG THR ABT"

TABLE = """
A D  Dq Dq Dq Dp MP IC Dq Ds Ds BY BY Dq D
( D  D  D  D  D  MP IC D  Ds Ds BY BY D  D
) D0 D0 D0 D0 D0 MP D  D0 Ds Ds BY BY D0 D0
| D  D  D  D  D  MP IC D  Ds Ds D  D  D  D
C D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
/ V  V  V  V  V  MP IC V  Ds Ds V  V  V  V
; D  D  D  D  D  MP IC D  Ds Ds D  D  D  D
? V  V  V  V  V  MP IC V  Ds Ds V  V  V  V
+ D  Dq Dq Dq Dp MP IC Dq Ds Ds BY BY Dq D
H D  D  D  D  D  MP IC D  Ds Ds BY D  D  D
J D  BY BY BY D  MP IC BY Ds Ds BY D  BY D
G D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
Y D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
S V  V  V  V  V  MP IC V  Ds Ds V  V  V  V
L D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
M D  Dq Dq Dq Dp MP Db Dq Ds Ds BY BY Dq D
{ D0 D  D  D0 D0 MP IC D  Ds Ds D  D0 D  D0
} D0 D0 D0 D  D0 MP IC D0 Ds Ds D0 D0 D0 D0
* PR PR PR PR PR MP IC PR Ds Ds PR PR PR PR
F D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
Z D  BY BY BY D  MP IC BY IP IP BY BY BY D
Q D0 D  D  D  D0 MP D  D  Ds D  D  D  D  D0
N V  V  V  V  V  MP IC V  Ds Ds V  V  V  V
E V  V  V  V  V  MP IC V  Ds Ds V  V  V  V
R V* V* V* V* V* MP IC V* Ds Ds BY V* V* V*
K NP NP NP NP NP D  IC NP Ds Ds NP NP NP NP
& R& R& R& R& R& R& R& R& R& R& R& R& R& R&
U D  BY BY BY D  MP IC BY Ds Ds BY BY BY D
I D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
= D  D  D  D  D  MP IC D  Ds Ds BY D  D  D
B D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
D D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
~ BC BC BC BC BC MP IC BC Ds Ds BY BC BC BC
. D  BY BY BY D  MP IC BY IP IP BY BY BY D
P D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
X D  Dq Dq Dq D  MP IC Dq Ds Ds BY D  Dq D
V D  Dq Dq Dq D  MP Db Dq Ds Ds BY D  Dq D
[ V  V  V  V  V  MP IC V  Ds Ds V  V  V  V
: V  V  V  V  V  MP IC V  Ds Ds V  V  V  V
T D  Dq Dq Dq Dp MP IC Dq Ds Ds BY BY Dq D
"""


def cells() -> dict[tuple[str, str], str]:
    """The word of each cell by command and state."""
    return {
        (line[0], column): word
        for line in TABLE.strip().splitlines()
        for column, word in zip(COLUMNS.split(), line[1:].split(), strict=True)
    }


ARROWS = """
A RDY>MOV HLD>HPD ABT>MOV
( RDY>CCB MOV>CCB QUE>CCB PAU>CCB HLD>CCB CCX>CCB THR>CCB ABT>CCB
) CCB>CCX
+ RDY>MOV HLD>HPD ABT>MOV
H RDY>HLD ABT>HLD
J RDY>JOG HLD>JOG JOG>RDY ABT>JOG
M RDY>MOV HLD>HPD ABT>MOV
{ MOV>PAU QUE>PAU CCX>PAU RUN>PAU THR>PAU
} PAU>MOV
Z RDY>PRG HLD>PRG ABT>PRG
Q MOV>ABT QUE>ABT PAU>ABT CCB>RDY CCX>ABT CFG>RDY RUN>ABT THR>ABT
K HPD>MOV
U RDY>RUN HLD>RUN ABT>RUN
. RDY>CFG HLD>CFG ABT>CFG
T RDY>THR HLD>HPD ABT>THR
| ABT>RDY
"""
"""Where a command leads; the last row by what ends ABT.  All else stays where it is."""


def arrows() -> dict[tuple[str, str], str]:
    """The state behind each cell that leads elsewhere."""
    found = {}
    for line in ARROWS.strip().splitlines():
        letter, *ways = line.split()
        for before, after in (way.split(">") for way in ways):
            found[letter, before] = after
    return found


REACHED = {
    "RDY": (),
    "MOV": ("M5000",),
    "QUE": ("M5000", "M,1"),
    "PAU": ("M5000", "{"),
    "HLD": ("H",),
    "HPD": ("H", "M3000"),
    "CCB": ("(", "M3000"),
    "CCX": ("(", "M5000", ")"),
    "PRG": ("Z", "M1"),
    "CFG": (".", "M1"),
    "RUN": ("Z", "M5000", "\x04", "U"),
    "JOG": ("J1",),
    "THR": ("T5,0,0,0,10",),
    "ABT": ("M5000", "Q"),
}
"""What brings a board into each state, with something in it that can be lost."""
