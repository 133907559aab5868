"""What models can do, as Protocols with typed values, and how implementations are found by kind and name."""
