"""What things cost, peers side by side."""
