"""From compared numbers to tables, figures, pages and films."""
