"""Small windows over a screen. STOP works in all of them; Escape closes each without effect."""

from zendsp.tui.dialogs.choose import Choose, Option
from zendsp.tui.dialogs.form import Field, Form, not_empty
from zendsp.tui.dialogs.sliders import Sliders, slides
from zendsp.tui.dialogs.text import Message

__all__ = ["Choose", "Field", "Form", "Message", "Option", "Sliders", "not_empty", "slides"]
