"""What the detector reports to its user."""


class DetectorError(Exception):
    """Anything wrong with a model or with what the detector is given."""


class ModelError(DetectorError):
    """A model file cannot be used: foreign, damaged or of another version."""


class ModelMismatch(DetectorError):
    """A model and the device's settings do not belong together: change one of them."""


class EvaluationError(DetectorError):
    """What is to be evaluated is too little, or asked for in a way that does not exist."""
