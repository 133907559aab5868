"""Language and vision models behind one typed question: endpoints, limits, retries and a note of every call."""
