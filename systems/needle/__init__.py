"""What a needle is, and the hand that pushes it."""
