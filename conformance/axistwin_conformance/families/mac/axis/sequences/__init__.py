"""Operations of an axis, and the machine that chains them."""
