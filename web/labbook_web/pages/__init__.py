"""The pages of the app: each module makes one kind of page out of what the store has."""
