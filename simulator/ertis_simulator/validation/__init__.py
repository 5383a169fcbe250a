"""The simulator checked like an instrument: against physics nobody tuned, and one real ping."""
