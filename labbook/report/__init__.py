"""Report of a study: its page with sections, tables and figures, and the hook for the analyses of papers."""
