"""Where a stored number comes from: its tree of inputs, whether all of it is as it was, and computing it again."""
