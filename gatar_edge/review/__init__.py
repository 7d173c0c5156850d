"""Reading, explaining and showing logs."""
