"""The agent `actor_critic`, a plugin of karolos."""
