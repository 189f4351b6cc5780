"""Operations of a unit, and the machine that chains them."""
