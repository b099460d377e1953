"""The pages of the app: each module makes one kind of page from the contents of the store."""
