"""Pages of the manual that are made from README.md, from the types of scenes and from the commands themselves."""

import os
import pathlib
import re
import shutil
import subprocess

DOCS = pathlib.Path(__file__).parent
ROOT = DOCS.parent
OUT = DOCS / "generated"

# Page: title and the sections of README that it holds.
SECTIONS = {
    "commands-in-short": ("What it does", ["What it does"]),
    "files": ("Files in and out", ["Files in and out"]),
    "noise": ("Noise", ["Noise"]),
    "python": ("From Python", ["From Python"]),
    "laws": ("A hierarchy of laws", ["A hierarchy of laws", "A learned law elsewhere"]),
    "turbulence": ("Is it turbulence?", ["Is it turbulence?"]),
    "terms": ("Terms of your own", ["Terms, and your own"]),
    "navier-stokes": ("Navier–Stokes turbulence", ["Turbulence that SPH did not make"]),
    "validation": ("Validation", ["Against a known solution", "What it promises", "Where it holds, and where it breaks"]),
    "search": ("Why the search takes six iterations", ["Why the search takes six iterations"]),
    "speed": ("Speed, and bias of the numbers", ["How fast", "Bias of these numbers", "Choosing"]),
}

COMMANDS = [
    "train", "simulate", "import", "export", "assimilate", "evaluate", "advise", "export-law", "trade", "replay", "reproduce",
]


def write():
    """Writes all pages."""
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir()
    of_readme()
    (OUT / "scene-keys.md").write_text(scene_keys())
    (OUT / "commands.md").write_text(commands())
    (OUT / "equations.md").write_text(here((DOCS / "equations.md").read_text(), {}))


def slug(heading):
    """The anchor of a heading."""
    return re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")


def sections():
    """The sections of README by heading."""
    parts = re.split(r"^## (.+)$", (ROOT / "README.md").read_text(), flags=re.M)
    return dict(zip(parts[1::2], parts[2::2]))


def of_readme():
    """A page for each entry of SECTIONS."""
    found = sections()
    missing = [name for _, names in SECTIONS.values() for name in names if name not in found]
    if missing:
        raise SystemExit(f"docs/pages.py names sections that README.md does not have: {missing}")
    places = {}
    for page, (_, names) in SECTIONS.items():
        for name in names:
            for heading in [name, *re.findall(r"^### (.+)$", found[name], flags=re.M)]:
                places[slug(heading)] = page
    for page, (title, names) in SECTIONS.items():
        lone = len(names) == 1
        # The first section may have the title of its page.
        body = [found[name] if lone or name == title else f"## {name}\n{found[name]}" for name in names]
        text = "\n".join(body)
        text = re.sub(r"^### ", "## " if lone else "### ", text, flags=re.M)
        (OUT / f"{page}.md").write_text(f"# {title}\n\n{here(text, places)}")


def here(text, places):
    """Text whose links lead on from a generated page: pictures stay, files of the repository become their paths."""

    def link(match):
        bang, label, target = match.groups()
        if re.match(r"[a-z]+:", target):
            return match.group(0)
        path, _, anchor = target.partition("#")
        if not path:
            page = places.get(anchor)
            return f"[{label}]({page}.md)" if page else label
        path = path.removeprefix("../")
        if bang:
            return f"![{label}](../../{path})"
        if path.endswith("docs/equations.md") or path == "equations.md":
            return f"[{label}](equations.md)"
        if path.endswith((".svg", ".png")):
            return f"{label} (`{path}`)"
        return label if label.strip("`") == path or label.startswith("`") else f"{label} (`{path}`)"

    return re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", link, text)


# A field of a struct or a variant of an enum, with its documentation and attributes.
ITEM = re.compile(
    r"((?:^[ \t]*///[^\n]*\n)+)((?:^[ \t]*#\[[^\n]*\n)*)^[ \t]*(?:pub )?(?:r#)?(\w+)(?:: ([^\n]+?))?(,| \{|\()", re.M
)


class Types:
    """The types of scenes, read from the source."""

    def __init__(self):
        folders = ["src/scene", "src/forcing", "src/flow", "src/kernel", "src/models", "systems", "src/sensitivity", "src"]
        files = [path for folder in folders for path in sorted((ROOT / folder).glob("*.rs"))]
        files += sorted((ROOT / "src/flow").glob("*/*.rs")) + sorted((ROOT / "systems/forcing").glob("*.rs"))
        self.bodies, self.defaults, self.of_struct = {}, {}, {}
        for path in dict.fromkeys(files):
            text = path.read_text()
            every = r"((?:^#\[[^\n]*\n)*)^pub (struct|enum) (\w+) \{\n(.*?)^\}"
            for attributes, kind, name, body in re.findall(every, text, flags=re.M | re.S):
                self.bodies.setdefault(name, (kind, attributes, body))
            own = r"^impl Default for (\w+) \{.*?Self \{(.*?)\}\n    \}\n^\}"
            for name, body in re.findall(own, text, flags=re.M | re.S):
                pairs = re.findall(r"(\w+): ([^,{}]+(?:\{[^{}]*\})?)(?:,|\s*$)", body)
                self.of_struct.setdefault(name, {key: " ".join(value.split()) for key, value in pairs})
            for name, body in re.findall(r"fn (\w+)\(\) -> [\w:<>]+ \{\s*([^{};]+?)\s*\}", text):
                self.defaults.setdefault((path, name), body)
                self.defaults.setdefault(name, body)

    def items(self, name):
        """Kind, and (name, type, attributes, documentation) of every field or variant."""
        kind, outer, body = self.bodies[name]
        found = []
        for text, attributes, item, of, _ in ITEM.findall(body):
            words = " ".join(line.strip()[3:].strip() for line in text.strip().split("\n"))
            if not text.startswith("     "):
                found.append([item, of.strip(), attributes, words])
            elif found:
                # A field of the variant before it.
                found[-1][3] += f" `{item}`: {words}"
                found[-1][1] += f" {of}"
        if kind == "struct" and re.search(r"serde\([^)]*\bdefault\b", outer):
            own = self.of_struct.get(name, {})
            for entry in found:
                value = own.get(entry[0])
                value = self.defaults.get(re.sub(r"^defaults::|\(\)$", "", value), value) if value else None
                entry[2] += f'default = "{value}"' if value and "default" not in entry[2] else "default"
        return kind, found


def plain(words):
    """Documentation without rustdoc's links."""
    words = re.sub(r"\[`([^`\]]+)`\](?:\([^)]*\))?", r"`\1`", words)
    words = re.sub(r"\s*```.*?```", "", words)
    return words.replace("|", "\\|").replace("crate::", "whirls::")


def kebab(name):
    """The name of a variant in a scene."""
    return re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower()


def default(attributes, types):
    """The default that serde's attribute names."""
    named = re.search(r'default = "(?:defaults::)?([^"]+)"', attributes)
    if named:
        value = " ".join(types.defaults.get(named.group(1), named.group(1)).split())
        if value.endswith("::default()"):
            return ""
        value = {"None": "none", "Vec::new()": "none", "std::f64::consts::TAU": "2π"}.get(value, value)
        return value if value == "none" else f"`{kebab(value.rpartition('::')[2])}`"
    return "" if "default" in attributes else "needed"


def scene_keys():
    """Every key of a scene, from the documentation of its types."""
    types = Types()
    lines = [
        "# Keys of a scene\n",
        "A scene is a TOML file. Every key stands here with its meaning; *needed* marks those without a default, and a key "
        "with neither is left out or has the default that its text names. `--print-scene` prints a scene as it runs, `--set "
        "key=value` changes one key. This page is made from the types that read scenes.\n",
    ]
    done = set()

    def table(name, path):
        if name in done or name not in types.bodies:
            return
        done.add(name)
        kind, items = types.items(name)
        rows, later = [], []
        for item, of, attributes, words in items:
            # What runs write, not users.
            if "serde(skip)" in attributes or item == "chosen":
                continue
            inner = re.findall(r"\w+", of)
            key = item if kind == "struct" else f'"{kebab(item)}"'
            rows.append(f"| `{key}` | {plain(words)} |" + (f" {default(attributes, types)} |" if kind == "struct" else ""))
            # The fields of a variant stand beside its kind.
            where = path if kind == "enum" else f"{path}.{item}" if path else item
            later += [(part, where) for part in inner if part in types.bodies]
        title = f"`[{path}]`" if kind == "struct" and path else ("At the top" if not path else f"Values of `{path}`")
        if rows:
            head = "| key | meaning | default |\n|---|---|---|" if kind == "struct" else "| value | meaning |\n|---|---|"
            lines.append(f"\n## {title}\n\n{head}")
            lines.extend(rows)
        for part, where in later:
            table(part, where)

    table("Scene", "")
    return "\n".join(lines) + "\n"


def commands():
    """`--help` of every command."""
    # Where cargo puts programs.
    program = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release/whirls"
    call = [program] if program.is_file() else ["cargo", "run", "--quiet", "--release", "--bin", "whirls", "--"]
    lines = ["# Commands\n", "Each is a program of its own, and a word of `whirls`: `whirls train` is `train`.\n"]
    for command in COMMANDS:
        text = subprocess.run([*call, command, "--help"], capture_output=True, text=True, check=True, cwd=ROOT).stdout
        lines.append(f"\n## {command}\n\n```text\n{text.rstrip()}\n```")
    return "\n".join(lines) + "\n"
