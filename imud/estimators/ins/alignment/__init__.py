"""Roll, pitch and heading from the start on: levelling, in-motion alignment, and the transitions to navigation."""
