"""Before any check: whether the unit has what the operator has named, and follows it."""
