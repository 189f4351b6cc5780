"""What a run tells: terminal, page, JSON, JUnit, plots, comparison."""
