from ._application import console_app as console_app
