"""Ultrasound volumes with needles, made independently of the project's own renderer.

An echo is the linear convolution of the tissue's scatterers with a point spread that varies with
depth (Bamber and Dickinson 1980; Meunier and Bertrand 1995). Diffuse scatterers make fully
developed speckle, whose envelope has a Rayleigh distribution (Wagner et al. 1983). A needle is a
line of coherent and diffuse reflectors whose echo depends on the angle of incidence, with
reverberation beneath it (Huang et al. 2007; Reusz et al. 2014). The image is log-compressed with a
random dynamic range and gain, after electronic noise that grows with depth.

No constant and no code comes from the renderer, so a tracker tuned to the one is tested by the
other.
"""

from .cases import KINDS, Scene, sequence_case, volume_case
from .needles import Truth

__all__ = ["KINDS", "Scene", "Truth", "sequence_case", "volume_case"]
