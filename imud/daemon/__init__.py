"""The running daemon: its loop, its ports, and what it says of itself."""
