"""What the benchmarks share. The devices import neither roclog nor a Modbus library."""
