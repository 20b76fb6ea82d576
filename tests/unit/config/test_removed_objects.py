import pytest

from roadsight.base.errors import InputError
from roadsight.base.section import validated
from roadsight.config.sites import PlacementInputs
from roadsight.placement.sight.objects import kind_of_name


@pytest.mark.parametrize("name", ["tree+115+140", "sign-208+3", "pole+0-12-2"])
def test_names_as_they_are_given(name):
    assert validated(PlacementInputs, {"remove": [name]}, "site.yaml").remove == [name]
    assert kind_of_name(name) == name[:4]


@pytest.mark.parametrize("name", ["", "tree", "-x", "tree+1+2; rm", "a tree"])
def test_what_no_object_is_called_is_refused(name):
    with pytest.raises(InputError, match="remove"):
        validated(PlacementInputs, {"remove": [name]}, "site.yaml")
