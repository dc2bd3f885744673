"""The live web page: what the loop does, in 3D, pictures and plots, and the means to move and to stop the arm.

``state``, ``scene`` and ``plots`` make what is drawn of what was heard, and know neither bus nor browser;
``streams`` and ``pictures`` listen while somebody looks; ``hand`` asks for what a viewer wants;
``server``, ``nodes``, ``panels`` and ``view`` are the browser's side; ``service`` is the process.
"""
