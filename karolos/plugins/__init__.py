"""Tools for authors of plugins: contracts, inspection, starter packages."""
