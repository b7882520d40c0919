"""The complete state of a run on disk, and how it is taken up again."""
