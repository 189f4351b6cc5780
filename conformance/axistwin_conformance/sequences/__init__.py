"""Operations played against a model: drawn, by a machine or recorded; shrunk when they fail."""
