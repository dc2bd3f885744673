"""What the cameras and the vision see, as one picture to look at."""
