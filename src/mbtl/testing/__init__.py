"""Contract suites that a new selector, storage or CMDP joins with one line. They need pytest."""
