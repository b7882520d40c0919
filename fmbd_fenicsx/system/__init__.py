"""Floor 3: the scene a user builds, the system of all blocks, its plan and sensors."""
