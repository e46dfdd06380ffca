"""What the author of a plugin needs: contracts, inspection, starter packages."""
