"""The MN400 on USB: reports, without addresses, sums, START and DONE (ledger 2.8)."""
