"""From joint positions to joint angles, inverse kinematics and joint commands; usable without the bus."""
