"""What is done, missing, partial or stale of a study, and why, with a forecast of time and disk."""
