"""How the errors of one sensor are found in recordings, each with 1 sigma; unfit data is refused with the reason."""
