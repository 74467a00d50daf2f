"""The C side: isr.h, the runtime, the machines, and the Python that compiles them through cffi."""
