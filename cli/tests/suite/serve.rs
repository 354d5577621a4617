//! `serve --mcp`: what it answers is what the commands say and draw.

use crate::support::*;

#[cfg(not(feature = "mcp"))]
#[test]
fn a_program_without_the_protocol_says_how_to_build_it() {
    refused(&run!("serve {} --mcp", asset_at("room.ply")), 2, &["--features mcp has it"]);
    refused(&run!("serve {}", asset_at("room.ply")), 2, &["--mcp"]);
}

#[cfg(feature = "mcp")]
mod spoken {
    use super::*;
    use base64::prelude::{BASE64_STANDARD, Engine};
    use scenesplat::scene::picture::read_picture;
    use serde_json::{Value, json};
    use std::collections::BTreeSet;
    use std::io::{BufRead, BufReader, Read, Write};
    use std::process::{Child, ChildStdout, Command, Stdio};

    /// A running server, spoken to line by line.
    struct Client {
        child: Child,
        said: BufReader<ChildStdout>,
        last: u64,
    }

    impl Client {
        /// Starts a server, and introduces itself.
        fn start(line: &str) -> Self {
            let mut client = Self::silent(line);
            let about = json!({
                "protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": { "name": "test", "version": "1" }
            });
            let begun = client.ask("initialize", &about);
            assert_eq!(begun["serverInfo"]["name"], "scenesplat");
            assert!(begun["capabilities"]["tools"].is_object(), "{begun}");
            client.send(&json!({ "jsonrpc": "2.0", "method": "notifications/initialized" }));
            client
        }

        fn silent(line: &str) -> Self {
            let mut command = program();
            command.args(words(&format!("serve {line} --mcp")));
            let piped = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
            let mut child = piped.spawn().unwrap();
            let said = BufReader::new(child.stdout.take().unwrap());
            Self { child, said, last: 0 }
        }

        fn send(&mut self, message: &Value) {
            let input = self.child.stdin.as_mut().unwrap();
            writeln!(input, "{message}").unwrap();
            input.flush().unwrap();
        }

        /// The whole answer to a request.
        fn answer(&mut self, method: &str, params: &Value) -> Value {
            self.last += 1;
            let id = self.last;
            self.send(&json!({ "jsonrpc": "2.0", "id": id, "method": method, "params": params }));
            let mut line = String::new();
            self.said.read_line(&mut line).unwrap();
            let answer: Value =
                serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:?}"));
            assert_eq!(answer["id"], id, "{answer}");
            answer
        }

        fn ask(&mut self, method: &str, params: &Value) -> Value {
            let answer = self.answer(method, params);
            assert!(answer["error"].is_null(), "{answer}");
            answer["result"].clone()
        }

        fn call(&mut self, tool: &str, arguments: &Value) -> Value {
            self.ask("tools/call", &json!({ "name": tool, "arguments": arguments }))
        }

        /// What a tool answers.
        fn told(&mut self, tool: &str, arguments: &Value) -> Value {
            let result = self.call(tool, arguments);
            assert_eq!(result["isError"], false, "{result}");
            let json = result["structuredContent"].clone();
            let text = result["content"].as_array().unwrap().last().unwrap();
            assert_eq!(
                serde_json::from_str::<Value>(text["text"].as_str().unwrap()).unwrap(),
                json
            );
            json
        }

        /// Why a tool answers nothing.
        fn failed(&mut self, tool: &str, arguments: &Value) -> String {
            let result = self.call(tool, arguments);
            assert_eq!(result["isError"], true, "{result}");
            result["content"][0]["text"].as_str().unwrap().to_owned()
        }

        /// A picture, and what is said of it.
        fn drawn(&mut self, arguments: &Value) -> (Vec<u8>, Value) {
            let result = self.call("picture", arguments);
            let picture = &result["content"][0];
            assert_eq!(
                (&picture["type"], &picture["mimeType"]),
                (&"image".into(), &"image/png".into()),
                "{result}"
            );
            let png = BASE64_STANDARD.decode(picture["data"].as_str().unwrap()).unwrap();
            (png, result["structuredContent"].clone())
        }

        /// Closes the input: exit code, what is left on standard output, standard error.
        fn end(mut self) -> (Option<i32>, String, String) {
            drop(self.child.stdin.take());
            self.ended()
        }

        fn ended(mut self) -> (Option<i32>, String, String) {
            let (mut rest, mut told) = (String::new(), String::new());
            self.said.read_to_string(&mut rest).unwrap();
            self.child.stderr.take().unwrap().read_to_string(&mut told).unwrap();
            (self.child.wait().unwrap().code(), rest, told)
        }
    }

    fn numbers(value: &Value) -> Vec<f64> {
        value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    }

    fn spaced(value: &Value) -> String {
        numbers(value).iter().map(f64::to_string).collect::<Vec<_>>().join(",")
    }

    #[test]
    fn a_client_hears_what_the_commands_say_and_sees_what_they_draw() {
        let folder = Folder::new();
        let (room, names) = (folder.room("room.ply", 12_000, 9), folder.names());
        let out = folder.at("out");
        let said = printed(&run!(
            "objects {room} --label-names {names} --find 'chair near the table' --out {out}"
        ));
        let table = json(folder.path("out/objects.json"));
        let all = table["objects"].as_array().unwrap();
        let mut client = Client::start(&format!("{room} --label-names {names}"));

        let listed = client.ask("tools/list", &json!({}));
        let tools: Vec<&Value> = listed["tools"].as_array().unwrap().iter().collect();
        let of =
            |name: &str| tools.iter().map(|t| t[name].to_string()).collect::<Vec<_>>().join(" ");
        assert_eq!(of("name"), r#""objects" "find" "query" "measure" "picture""#);
        for tool in &tools {
            assert_eq!(tool["inputSchema"]["type"], "object");
            assert_eq!(tool["annotations"]["readOnlyHint"], true);
        }
        assert_eq!(tools[1]["inputSchema"]["required"], json!(["phrase"]));

        let mut short = client.told("objects", &json!({}));
        for (object, whole) in short["objects"].as_array_mut().unwrap().iter_mut().zip(all) {
            object["box"]["corners"] = whole["box"]["corners"].clone();
        }
        assert_eq!(short, table);

        // A phrase means the same objects, whose Gaussians are counted.
        let found = client.told("find", &json!({ "phrase": "chair near the table" }));
        let ids = |found: &Value| -> BTreeSet<u64> {
            found["objects"].as_array().unwrap().iter().map(|o| o["id"].as_u64().unwrap()).collect()
        };
        let printed_ids: BTreeSet<u64> = said
            .lines()
            .filter_map(|line| {
                line.strip_prefix("\"chair near the table\": ")?.split(' ').next()?.parse().ok()
            })
            .collect();
        assert!(!printed_ids.is_empty(), "{said}");
        assert_eq!(ids(&found), printed_ids);
        let count: u64 =
            found["objects"].as_array().unwrap().iter().map(|o| o["count"].as_u64().unwrap()).sum();
        assert_eq!(
            (&found["gaussians"]["count"], &found["gaussians"]["of"]),
            (&count.into(), &12_000.into())
        );
        // How it was read is said each time that it is asked.
        for _ in 0..2 {
            let taken = client.told("find", &json!({ "phrase": "chiar" }));
            has(&taken["notes"].to_string(), &["is taken for"]);
            assert!(!ids(&taken).is_empty());
        }
        let none = client.told("find", &json!({ "phrase": "toilet" }));
        assert_eq!(none["gaussians"]["count"], 0);
        has(&none["notes"].to_string(), &["none; there are: wall"]);

        let one = client.told("measure", &json!({ "from": 1 }));
        assert_eq!((&one["size"], &one["class"]), (&all[0]["box"]["size"], &all[0]["class"]));
        let [a, b] = [0, all.len() - 1].map(|i| numbers(&all[i]["position"]));
        let far = |a: &[f64], b: &[f64]| {
            a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
        };
        let objects = client.told("measure", &json!({ "from": 1, "to": all.len() }));
        assert!((objects["distance"].as_f64().unwrap() - far(&a, &b)).abs() < 1e-9, "{objects}");
        assert!(objects["gap"].as_f64() <= objects["distance"].as_f64());
        let points = client.told("measure", &json!({ "from": [0, 0, 0], "to": [3, 4, 12] }));
        assert_eq!((points["distance"].as_f64(), points["gap"].as_f64()), (Some(13.0), Some(13.0)));
        let inside = client.told("measure", &json!({ "from": all.len(), "to": b }));
        assert_eq!(inside["gap"].as_f64(), Some(0.0));

        // The same bits as `render`, also where the program chooses where to stand.
        let place = json!({ "eye": [0.5, 0.25, 1.5], "target": [1.0, 1.0, 1.0], "fov": 70, "size": "96x64" });
        let (png, about) = client.drawn(&place);
        done(&run!(
            "render {room} --eye 0.5,0.25,1.5 --target 1,1,1 --fov 70 --size 96x64 --out {out}"
        ));
        assert!(png == bytes(folder.path("out/view.png")) && about["notes"].is_null(), "{about}");
        let chair = ids(&found).into_iter().next().unwrap();
        let (png, about) = client.drawn(&json!({ "object": chair, "size": "96x64" }));
        let at = &all[chair as usize - 1];
        assert_eq!((&about["target"], &about["class"]), (&at["position"], &at["class"]));
        let (eye, target) = (spaced(&about["eye"]), spaced(&about["target"]));
        done(&run!("render {room} --eye {eye} --target {target} --size 96x64 --out {out}"));
        assert!(png == bytes(folder.path("out/view.png")));
        let seen = read_picture(&folder.path("out/view.png")).unwrap().to_rgb8();
        // It is seen from there: without chairs the picture is another.
        let gone = folder.at("gone");
        done(&run!("objects {room} --label-names {names} --remove chair --out {gone}"));
        done(&run!(
            "render {gone}/edited.ply --eye {eye} --target {target} --size 96x64 --out {out}"
        ));
        let without = read_picture(&folder.path("out/view.png")).unwrap().to_rgb8();
        let apart = |(a, b): (&[u8; 3], &[u8; 3])| (0..3).any(|k| a[k].abs_diff(b[k]) > 20);
        let other = seen.pixels().iter().zip(without.pixels()).filter(|both| apart(*both)).count();
        assert!(other > 96 * 64 / 10, "{other} pixels");
        let (_, about) = client.drawn(&json!({ "eye": [0, 0, 500], "target": [0, 0, 501] }));
        assert_eq!(
            (&about["notes"][0], &about["size"]),
            (&"the picture shows no Gaussian".into(), &json!([640, 480]))
        );

        let (code, rest, told) = client.end();
        assert_eq!((code, rest.as_str()), (Some(0), ""), "{told}");
        has(&told, &["the scene is labeled"]);
    }

    #[test]
    fn wrong_arguments_are_errors_in_the_words_of_the_command_line() {
        let folder = Folder::new();
        let (room, names) = (folder.room("room.ply", 8_000, 9), folder.names());
        let mut client = Client::start(&format!("{room} --label-names {names} --quiet"));
        let by_hand = run!(
            "objects {room} --label-names {names} --find 'table left of a wall' --out {}",
            folder.at("out")
        );
        let due = refused(&by_hand, 2, &["left of"]);
        let text = client.failed("find", &json!({ "phrase": "table left of a wall" }));
        has(&due, &[&format!("error: {text}\n")]);
        for (tool, arguments, part) in [
            ("find", json!({}), "phrase: a text is expected"),
            ("find", json!({ "phrase": 5 }), "phrase: a text is expected"),
            ("find", json!({ "phrase": "spaceship" }), "spaceship"),
            ("find", json!({ "phrase": "red chair" }), "objects are not told by color"),
            (
                "find",
                json!({ "phrase": "chair", "near": 1 }),
                "find: no argument \"near\"; there are: phrase",
            ),
            ("objects", json!({ "class": "chair" }), "there are: none"),
            ("query", json!({ "phrase": "chair" }), "there are no features to ask"),
            ("measure", json!({}), "from: the id of an object or a point"),
            ("measure", json!({ "from": 0 }), "there is no object 0; objects are 1 to "),
            ("measure", json!({ "from": 1, "to": 999 }), "there is no object 999"),
            ("measure", json!({ "from": "chair" }), "there is no object \"chair\""),
            ("measure", json!({ "from": [1, 2] }), "\"1,2\" is no point; write three numbers"),
            ("measure", json!({ "from": [1, 2, 3] }), "a point has no size"),
            ("picture", json!({}), "give eye and target, or object"),
            ("picture", json!({ "eye": [1, 2, 3] }), "--target <X,Y,Z>"),
            ("picture", json!({ "target": [1, 2, 3] }), "--eye <X,Y,Z>"),
            ("picture", json!({ "eye": [1, 2], "target": [0, 0, 0] }), "\"1,2\" is no point"),
            ("picture", json!({ "object": 1, "target": [0, 0, 0] }), "give one of them"),
            ("picture", json!({ "eye": [1, 1, 1], "target": [1, 1, 1] }), "cannot look at"),
            ("picture", json!({ "object": 1, "fov": 500 }), "write an angle of 1 to 170 degrees"),
            ("picture", json!({ "object": 1, "size": "0x5" }), "is no size; write 640x480"),
            ("picture", json!({ "object": 1, "size": "--out" }), "is no size; write 640x480"),
        ] {
            has(&client.failed(tool, &arguments), &[part]);
        }
        let unknown = client.answer("tools/call", &json!({ "name": "delete", "arguments": {} }));
        has(
            unknown["error"]["message"].as_str().unwrap(),
            &["there is no tool \"delete\"", "measure"],
        );
        assert!(
            client.answer("resources/read", &json!({ "uri": "file:///etc/passwd" }))["error"]
                .is_object()
        );
        // It goes on after all of these.
        assert!(client.told("measure", &json!({ "from": 1 }))["size"].is_array());
        let (code, rest, told) = client.end();
        assert_eq!((code, rest.as_str(), told.as_str()), (Some(0), "", ""));
    }

    #[test]
    fn features_are_asked_as_query_asks_them() {
        let folder = Folder::new();
        let [room, texts] = ["room.ply", "classes.safetensors"].map(asset_at);
        let flags = format!("{TINY} --text {texts}");
        let mut client = Client::start(&format!("{room} {flags}"));
        let found = client.told("query", &json!({ "phrase": "chair" }));
        let said =
            printed(&run!("query {room} chair {flags} {SMALL_PICTURE} --out {}", folder.at("out")));
        let selected = labels(folder.path("out/selection.npy"));
        let count = selected.iter().filter(|s| **s == 1).count();
        assert!(count > 0);
        assert_eq!(found["gaussians"]["count"], count);
        has(&said, &[&format!("best score {:.4}", found["best_score"].as_f64().unwrap())]);
        has(
            &client.failed("query", &json!({ "phrase": "spaceship" })),
            &["is not among the", "nearest:"],
        );
        // What makes labels doubtful is told with them.
        has(&client.told("objects", &json!({}))["warnings"].to_string(), &["SEEDED WEIGHTS (0)"]);
        assert_eq!(client.end().0, Some(0));
    }

    #[test]
    fn it_ends_with_its_input_with_an_interrupt_and_with_a_scene_that_cannot_be_read() {
        let folder = Folder::new();
        let (room, names) = (folder.room("room.ply", 4_000, 9), folder.names());
        let flags = format!("{room} --label-names {names}");
        let mut client = Client::start(&flags);
        client.told("objects", &json!({}));
        let kill =
            Command::new("kill").args(["-INT", &client.child.id().to_string()]).status().unwrap();
        assert!(kill.success());
        let input = client.child.stdin.take();
        let (code, rest, told) = client.ended();
        assert_eq!((code, rest.as_str()), (Some(0), ""), "{told}");
        drop(input);

        let (code, rest, told) = Client::silent(&folder.at("none.ply")).ended();
        assert_eq!((code, rest.as_str()), (Some(1), ""));
        has(&told, &["none.ply"]);
        let mut client = Client::silent(&flags);
        client.send(&json!({ "jsonrpc": "2.0", "id": 1, "method": "tools/list" }));
        let (code, rest, told) = client.end();
        assert!(code.is_some() && !told.contains("panicked"), "{rest}{told}");
    }
}
