"""A study's numbers as tables, and its recorded runs and fields as files for ParaView."""
