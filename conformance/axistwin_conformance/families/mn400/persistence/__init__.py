"""What a board keeps: programs, id and rate, and what becomes of them when the supply is cut."""
