"""The rigid bodies of a machine: MuJoCo and URDF files, payloads and wrong links."""
