"""Roll, pitch and heading from the start on: levelling, in-motion alignment, and the modes of the filter."""
