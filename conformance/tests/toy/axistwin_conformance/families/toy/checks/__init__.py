"""What is asked of a lamp."""
