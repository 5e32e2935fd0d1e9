"""Learning, comparison, pictures, measurements, and the command line."""
