#!/usr/bin/env python3
"""Writes phrases.txt, the list of the phrase table, from WordNet 3.0, the encoder's vocabulary and the words below.

  apt-get download wordnet-base && dpkg-deb -x wordnet-base_*.deb DIR
  python3 crates/text/assets/phrases.py DIR/usr/share/wordnet MINILM/vocab.txt

Taken are the words of WordNet that the encoder reads as one piece, which are the common ones; nouns that its texts are
tagged with; all it has of things in homes; and what stands below: what is in a home, what is done there, and the names
of the classes of the synthetic rooms with their synonyms, which the table has to hold. Standard library only.
"""
import re
import sys
from collections import Counter
from pathlib import Path

LEXICON = ("Tops act animal artifact attribute body cognition communication event feeling food group location motive "
           "object person phenomenon plant possession process quantity relation shape state substance time").split()
FORM = re.compile(r"^[a-z]+(?:[ '-][a-z]+){0,2}$")
DROPPED = set("a an the this that these those some any my your his her its our their please is are am".split())
SAME = dict(we="i", you="i", he="i", she="i", they="i", people="i", somewhere="place", anywhere="place",
            anything="something", stuff="something")

# How often a noun of more than a piece must be tagged in WordNet's texts to be taken, by what it is; else twice.
LEAST_TAGGED = dict(artifact=1, food=1, plant=1, animal=1, substance=1, object=1)
# What is in homes, with all that WordNet counts among it: the first words of its groups, and which sense.
HOUSEHOLD = """furniture:1 appliance:2 container:1 tableware:1 fabric:1 floor_cover:1 room:1 door:1 window:1 wall:1
plumbing_fixture:1 plaything:1 musical_instrument:1 decoration:1 source_of_illumination:1 utensil:1 computer:1
electronic_equipment:1 consumer_goods:1 building_material:1 article:1 tool:1 padding:1 bedclothes:1 floor:1 timepiece:1
curtain:1 lock:1 heater:1 fan:1 cleaning_implement:1 writing_implement:1 publication:1 picture:1 basket:1 box:1 game:1
shelter:1 dish:2 beverage:1 fruit:1 vegetable:1 flower:1 pet:1 structural_member:1 support:10 rack:1 stove:1 shelf:1"""

CLASSES = """wall;floor;ceiling;window;door;table;coffee table;desk;chair;stool;sofa;bed;cabinet;kitchen cabinet;wardrobe;
bookshelf;nightstand;tv stand;tv;monitor;keyboard;laptop;lamp;plant;picture;mirror;curtain;rug;pillow;book;box;trash can;
mug;clock;radiator;toilet;sink;bathtub;refrigerator;stove;range hood;armchair;office chair;dining chair;footstool;ottoman;
couch;settee;dining table;kitchen table;office desk;reading desk;writing desk;dresser;sideboard;chest of drawers;cupboard;
file cabinet;bathroom cabinet;counter;kitchen counter;closet;armoire;bookcase;shelf;rack;night stand;bedside table;
tv cabinet;television stand;television;computer monitor;computer screen;display;notebook computer;light;ceiling light;
ceiling lamp;chandelier;floor lamp;table lamp;potted plant;house plant;painting;portrait;poster;photo;drapes;drape;carpet;
mat;cushion;carton;cardboard box;crate;bin;trash bin;trash;garbage bin;garbage can;recycling bin;wastebasket;cup;coffee mug;
alarm clock;heater;basin;washbasin;tub;bath;fridge;mini fridge;oven;cooker;extractor hood;cooker hood"""

# Things of today that a dictionary of 2006 lacks, and names of shops and homes.
MODERN = """air conditioner;air fryer;air purifier;artificial plant;baby monitor;barbecue grill;bath mat;bath towel;bathroom
mirror;bathroom scale;bathroom sink;bean bag;bed frame;bed sheet;bedside lamp;bedspread;bifold door;bike rack;board game;
bread bin;bread maker;bunk bed;cable box;candle holder;cat tree;ceiling fan;changing table;charging station;cleaning
supplies;climbing plant;clothes dryer;clothes hanger;clothes rack;coat hook;coat rack;coffee grinder;coffee machine;coffee
maker;computer chair;computer desk;computer mouse;console table;cook top;cooktop;corner desk;corner shelf;corner sofa;cutting
board;daybed;desk lamp;desk organizer;desktop computer;dining set;dish rack;dish towel;display cabinet;display case;dog bed;
double bed;double sink;drawer unit;dressing table;duvet cover;electric fireplace;electric kettle;emergency exit;end table;
entrance door;exercise bike;extension cord;fairy lights;fire alarm;fire extinguisher;fitted wardrobe;flat screen;flower vase;
folding chair;folding table;foot rest;french doors;front door;fruit bowl;game console;gaming chair;gaming monitor;garage door;
garden chair;gas stove;glass door;glass table;guest bed;hair dryer;hall stand;hand towel;hanging lamp;hanging plant;headboard;
headphones;high chair;hot plate;induction hob;ironing board;kitchen island;kitchen sink;kitchen unit;knife block;laminate
flooring;laundry basket;lava lamp;led light;led strip;light bulb;light switch;linen closet;living room table;lounge chair;love
seat;magazine rack;massage chair;media cabinet;medicine cabinet;memory foam;microwave oven;mini bar;mood light;mouse pad;murphy
bed;music stand;nest of tables;office cabinet;open shelf;outdoor chair;oven hood;paper towel;patio door;pedestal sink;photo
album;photo frame;picture frame;piggy bank;place mat;plant pot;plant stand;plasma tv;power outlet;power strip;pressure cooker;
projector screen;pull out couch;quilt cover;range cooker;recliner;recycling box;remote control;rice cooker;robot arm;robot
vacuum;rocking horse;roller blind;roman blind;room divider;salad bowl;screen door;seat cushion;security camera;serving cart;
sewing machine;shaving mirror;shoe cabinet;shoe rack;shower cabin;shower curtain;shower head;side table;single bed;skirting
board;sleeper sofa;sliding door;slow cooker;smart speaker;smartphone;smoke detector;soap dispenser;sofa bed;sofa cushion;sound
bar;space heater;spice rack;spin dryer;spot light;standing desk;standing lamp;step stool;storage bin;storage box;storage rack;
storage unit;string lights;study table;swivel chair;table cloth;table fan;tablet computer;tea kettle;tea towel;tissue box;
toaster oven;toilet brush;toilet paper;toilet roll;toilet seat;tool box;toothbrush holder;touch screen;towel rack;towel rail;toy
box;track lighting;trash bag;treadmill;tumble dryer;tv unit;umbrella stand;under cabinet light;usb charger;utility sink;vacuum
cleaner;vanity unit;video game;wall art;wall cabinet;wall lamp;wall light;wall mirror;wall painting;wall picture;wall shelf;wall
unit;walk in closet;wash basin;washing machine;waste bin;waste paper basket;water bottle;water cooler;water dispenser;water
heater;webcam;welcome mat;whirlpool tub;white board;wicker chair;wifi router;window blind;window frame;window seat;window sill;
wine cooler;wine glass;wine rack;wireless keyboard;wireless mouse;wood stove;work bench;work table;work top;yoga mat"""

# Household things, each also with what it may be made of, where it stands and what kind it is.
THINGS = """table chair stool sofa couch armchair bench bed cabinet cupboard shelf wardrobe dresser desk lamp light mirror
picture curtain rug carpet cushion pillow box basket bin mug cup clock sink counter door window drawer vase bowl shelves
rack stand"""
KINDS = """wooden metal glass plastic leather fabric wicker marble folding round square tall low small large old modern antique
corner wall hanging kitchen bathroom bedroom office garden hall dining childrens baby guest computer"""

# What is done at home, with what.
ACTIONS = """sit on;sit;sit at;lie on;lie down;lean on;rest on;rest;relax;sleep;sleep on;sleep in;take nap;dream;wake up;cook;
cook on;cook with;bake;bake in;boil water;fry;heat food;warm up food;keep food cold;keep food;keep food fresh;store food;
freeze food;eat;eat at;eat on;eat from;have breakfast;have lunch;have dinner;drink;drink from;drink coffee;drink tea;make
coffee;make tea;wash;wash hands;wash face;wash dishes;wash clothes;dry clothes;dry hands;dry hair;brush teeth;shower;take
shower;take bath;bathe;soak in;shave;comb hair;put on makeup;look at myself;see myself;go to toilet;pee;flush;dress;get
dressed;hang clothes;keep clothes;store clothes;put clothes;fold clothes;iron clothes;hang coat;keep shoes;work;work on;work
at;write;write on;write with;type;type on;type with;study;learn;do homework;read;read in;keep books;store books;put books;look
up words;compute;use computer;browse internet;play games;play;play music;listen to music;watch;watch tv;watch movies;watch
news;see pictures;look at;look through;look out;look out of;see outside;let in light;let in air;open and close;go through;
walk through;enter;leave;go in;go out;lock;climb;step on;stand on;walk on;lie on floor;stand;sweep;clean;clean with;mop;vacuum;
throw away trash;throw away rubbish;throw away;put trash;put garbage;recycle;store things;store;keep things;keep;hide;carry
things;carry;pack;ship things;move house;put things on;put drinks on;put cup on;put lamp on;put tv on;put feet on;put head on;
rest head on;rest feet on;hold;hold flowers;grow plants;grow;water;decorate wall;hang on wall;hang;cover floor;cover window;
cover;block light;block sun;keep out light;keep warm;heat room;warm room;heat;cool room;cool down;turn on;light room;light up;
see in dark;illuminate;tell time;know time;check time;wake me up;measure time;ventilate;remove smoke;remove smells;remove
steam;suck in air;extract air;hold up roof;separate rooms;hide behind;talk;call;pray;exercise;cut food;cut;sew;paint;draw"""
FRAMES = ["something to {}", "place to {}", "where i {}", "{}"]


def entries(text):
    return [" ".join(e.split()) for e in text.split(";")]


def normalized(text):
    words = []
    for word in re.split(r"[^a-z0-9']+", text.lower()):
        word = word.strip("'")
        word = (word[:-2] if word.endswith("'s") else word).replace("'", "")
        if word and word not in DROPPED:
            words.append(SAME.get(word, word))
    if len(words) > 1 and words[0] in ("thing", "things", "object", "item") and words[1] == "to":
        words[0] = "something"
    return " ".join(words)


def wordnet(folder, pieces):
    """Words of WordNet by the rules above."""
    read = lambda name: [l.split() for l in (folder / name).read_text().splitlines() if not l.startswith("  ")]
    tagged = Counter()
    for sense, _, times in read("cntlist.rev"):
        word, rest = sense.split("%")
        tagged[word.replace("_", " "), rest[0] == "1"] += int(times)
    synsets, parts = {}, {}
    for field in read("data.noun"):
        count = int(field[3], 16)
        words = [field[4 + 2 * i].replace("_", " ") for i in range(count)]
        synsets[field[0]] = (LEXICON[int(field[1]) - 3], words)
        pointers = field[5 + 2 * count:5 + 2 * count + 4 * int(field[4 + 2 * count])]
        for i in range(0, len(pointers), 4):
            if pointers[i] in ("@", "@i"):
                parts.setdefault(pointers[i + 1], []).append(field[0])
    nouns = {field[0]: field[-int(field[2]):] for field in read("index.noun")}
    found = set()
    for name in ("index.noun", "index.verb", "index.adj"):
        found.update(field[0] for field in read(name) if field[0] in pieces)
    for kind, words in synsets.values():
        found.update(w for w in words if tagged[w, True] >= LEAST_TAGGED.get(kind, 2))
        found.update(w.lower() for w in words if w.isupper() and w.lower() in pieces)
    for root in HOUSEHOLD.split():
        word, sense = root.split(":")
        waiting = [nouns[word][int(sense) - 1]]
        while waiting:
            synset = waiting.pop()
            found.update(synsets[synset][1])
            waiting.extend(parts.get(synset, []))
    return {word for word in found if FORM.match(word)}


def main():
    pieces = set(Path(sys.argv[2]).read_text(encoding="utf-8").split())
    phrases = wordnet(Path(sys.argv[1]), pieces)
    sizes = [len(phrases)]
    phrases.update(entries(CLASSES))
    phrases.update(entries(MODERN))
    phrases.update(kind + " " + thing for kind in KINDS.split() for thing in THINGS.split())
    phrases.update(frame.format(action) for frame in FRAMES for action in entries(ACTIONS))
    phrases = sorted({normalized(p) for p in phrases} - {""})
    out = Path(__file__).with_name("phrases.txt")
    out.write_text("".join(p + "\n" for p in phrases))
    print("%d phrases, %d of WordNet, %d bytes" % (len(phrases), sizes[0], out.stat().st_size))


if __name__ == "__main__":
    main()
