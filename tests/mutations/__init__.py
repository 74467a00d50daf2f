"""What must never be lost, each as a small change that takes it away, and the tests that should
notice.

    python -m tests.mutations                 # all of them
    python -m tests.mutations --only stop     # those with the word in their name
    python -m tests.mutations --list

A mutation is an entry of a TOML file in this folder:

    [[mutation]]
    name = "nan-trip"                              # unique
    lost = "a command that is not a number trips"  # the promise that the change breaks
    file = "c_isr/zendsp_isr/runtime/safety.c"
    old = "if (!isfinite(mv)) {"                   # stands in the file exactly once
    new = "if (0) {"
    tests = ["tests/target/test_safety.py::test_not_a_number_trips_and_never_reaches_the_machine"]

Each is applied alone to a copy of the tree. Every test that it names has to fail there, and to pass
without it. A change that leaves no program running proves nothing and counts as broken, and so does
one whose ``old`` is gone from the file.

A test that is named here must do no harm where the promise is gone: it asks for the right to send a
signal (signal 0) in place of ending the computer's processes. All runs in a PID namespace of its
own with bounded memory, and where there is none, not at all.
"""
