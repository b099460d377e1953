"""What the lab holds of a study: points, series, fits, references and statements; measured once, read from there."""
