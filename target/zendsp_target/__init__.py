"""The target process: monitor, runner, compile service and drives."""
