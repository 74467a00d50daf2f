from textual.widgets import Static
from zendsp.tui.actions import bindings
from zendsp.tui.screens.base import LabScreen
class ConsoleScreen(LabScreen):
    NAME="console"
    BINDINGS=bindings("console")
    def body(self): yield Static("x")
