"""Bodies of verbs, each imported when its verb is called, so that `labbook --help` loads no other room."""
