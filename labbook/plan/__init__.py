"""The runs that a study needs and a lab lacks, whether a backend can do them, and what they will cost."""
