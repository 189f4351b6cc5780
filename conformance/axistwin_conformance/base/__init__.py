"""What every floor uses: errors, verdicts, events, the ledger, checks, transcripts."""
