"""Tables, figures, pages and films of compared numbers."""
