"""Real cameras on the bus: frames under capture times, with what is known of each camera."""
