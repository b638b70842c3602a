"""Studies of the finger: each returns a record; reports draw them."""
