"""An extension of labbook."""
