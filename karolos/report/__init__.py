"""Tables, figures, pages and films of compared numbers, as files and served by `karolos ui`."""
