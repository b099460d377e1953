"""What a study found: analysis of its points, comparison with a paper, figures, and the page that shows them."""
