"""What an MSC replies when nobody judges it by a check: diagnosed, or read leniently."""
