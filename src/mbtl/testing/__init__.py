"""Contract suites that a new selector or CMDP joins with one line. They need pytest."""
