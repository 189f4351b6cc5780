"""What users and their programs may rely on, as it was recorded; see `test_contracts`."""
