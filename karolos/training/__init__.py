"""The training loop: collecting, learning, episodes, demonstrations, progress."""
