"""Replay and rollout buffers: storage, sampling, hindsight, augmentation."""
