from textual.widgets import Static
from zendsp.tui.actions import bindings
from zendsp.tui.screens.base import LabScreen
class ExecuteScreen(LabScreen):
    NAME="execute"
    BINDINGS=bindings("execute")
    def body(self): yield Static("x")
