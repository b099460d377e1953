"""How a run begins: filling, settling, and the packings that come of it."""
