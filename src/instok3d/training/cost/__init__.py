"""What a run would take, before it starts: time, memory, disk."""
