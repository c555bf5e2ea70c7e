"""What an interrupted diagnosis goes on from."""

from contextlib import contextmanager
from dataclasses import replace

from hidden_plants import model, rubbing, some_effects

from daest.diagnosis.built_in.trials import Trial, prepare
from daest.diagnosis.kept import KeptProofs
from daest.diagnosis.screening.candidates import pairs
from daest.model.diagnosis import Proof
from daest.modelica.places.sites import sites


@contextmanager
def whole_file(path):
    yield path


def test_proof_of_a_candidate_with_more_parameters_is_made_anew(tmp_path):
    """A kink that was refitted besides is a parameter that the candidate of the file does not have; an
    interrupted diagnosis had ended in a KeyError for it."""
    stand = rubbing()
    own = pairs(some_effects("CoulombFriction"), sites(model()))[0]
    prepared = prepare(stand.null.flat, stand.null.estimated, Trial(own, (0.1,), ()))
    fit = replace(stand.baseline, theta={p.name: p.value for p in prepared.flat.parameters})
    proof = Proof(own, prepared.flat, fit, 50.0, 95.0, 1e-9, 0.8, (), (), "supported", "")
    keeper = KeptProofs(tmp_path, "run", whole_file)
    keeper.keep(prepared, proof)
    assert keeper.found(prepared).verdict == "supported"
    sharp = replace(fit.parameters[0], name=f"{own.name}_1.v_s")
    keeper.keep(prepared, replace(proof, fit=replace(fit, parameters=(*fit.parameters, sharp))))
    assert keeper.found(prepared) is None
