"""Two backends on the same study: how long they agree, whether they measure the same, and what each costs."""
