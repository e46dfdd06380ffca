"""Order-based cutting of boards with defects, an environment plugin of karolos."""
