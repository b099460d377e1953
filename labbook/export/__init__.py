"""Numbers of a study as tables, and its recorded runs and fields as files for ParaView and as recordings."""
