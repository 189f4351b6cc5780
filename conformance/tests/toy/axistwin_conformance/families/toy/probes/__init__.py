"""What the manual of the lamp leaves open."""
