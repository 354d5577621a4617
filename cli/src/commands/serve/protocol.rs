//! The protocol: it runs on a thread of its own and hands what it is asked to the thread of the command, one request after
//! another.

use super::Args;
use super::answers::Scene;
use super::tools::{self, Answer, Tool};
use crate::flags::Shared;
use crate::progress::{interrupted, stop};
use crate::session::Session;
use crate::terminal::check_warnings;
use crate::version::VERSION;
use anyhow::{Context, Result, anyhow};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use rmcp::model::{
    CallToolRequestParams, CallToolResponse, CallToolResult, ContentBlock, ErrorData,
    Implementation, JsonObject, ListToolsResult, PaginatedRequestParams, ServerCapabilities,
    ServerConfig, ToolAnnotations,
};
use rmcp::service::{RequestContext, ServerInitializeError};
use rmcp::{RoleServer, ServerHandler, ServiceExt};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;
use tokio::sync::oneshot;

/// How often it is looked whether the user asked to stop.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// What a tool answers, or why not in the words of the command line.
type Reply = Result<Answer, String>;

/// A tool that is called.
struct Call {
    tool: Tool,
    arguments: JsonObject,
    reply: oneshot::Sender<Reply>,
}

/// Speaks until the input ends, or until the user stops it: neither is an error.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let labels = args.labels.settled()?;
    let running = args.running.clone();
    let shared = Shared { running, ..Shared::into_folder(&std::env::temp_dir(), false) };
    let session = Session::start_network(&shared, &labels.labelling.inference, None, line)?;
    labels.claim_inputs(&session)?;
    let (calls, called) = channel();
    // A client waits seconds for the first answer, a scene may take minutes.
    let speaking = Builder::new().name("mcp".to_owned()).spawn(move || speak(calls))?;
    let mut scene = Scene::label(&session, &labels)?;
    check_warnings()?;
    session.progress.say("the scene is labeled; waiting for requests on standard input");
    answer_all(&mut scene, &called, &speaking)?;
    // Where the user stopped it, the other thread may wait for input that never comes; the process does not wait for it.
    if speaking.is_finished() {
        speaking.join().map_err(|_| anyhow!("the protocol ended by a fault of this program"))??;
    }
    Ok(())
}

fn answer_all(
    scene: &mut Scene<'_>,
    called: &Receiver<Call>,
    speaking: &JoinHandle<Result<()>>,
) -> Result<()> {
    loop {
        match called.recv_timeout(LOOK_EVERY) {
            // Who asked is gone, or has withdrawn the request.
            Ok(Call { reply, .. }) if reply.is_closed() => {}
            Ok(Call { tool, arguments, reply }) => {
                let answer = scene.answer(tool, &arguments).map_err(|e| format!("{e:#}"));
                drop(reply.send(answer));
            }
            Err(RecvTimeoutError::Timeout) if interrupted() => return Ok(()),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                while !speaking.is_finished() && !interrupted() {
                    std::thread::sleep(LOOK_EVERY / 10);
                }
                return Ok(());
            }
        }
    }
}

/// Speaks the protocol on standard input and output until the input ends.
fn speak(calls: Sender<Call>) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let spoken = runtime.block_on(async {
        let begun = Server { calls }.serve(rmcp::transport::stdio()).await;
        // A client that went before it said anything.
        if matches!(begun, Err(ServerInitializeError::ConnectionClosed(_))) {
            return Ok(());
        }
        let server = begun.context("standard input: no session of the protocol began")?;
        server.waiting().await.context("the protocol broke off")?;
        Ok(())
    });
    // Labels that nobody is going to ask for need not be finished.
    stop();
    spoken
}

/// What the protocol's own library calls.
struct Server {
    calls: Sender<Call>,
}

impl ServerHandler for Server {
    fn get_info(&self) -> ServerConfig {
        ServerConfig::new(ServerCapabilities::builder().enable_tools().build())
            .with_server_info(Implementation::new("scenesplat", VERSION))
            .with_instructions(tools::INSTRUCTIONS)
    }

    async fn list_tools(
        &self,
        _: Option<PaginatedRequestParams>,
        _: RequestContext<RoleServer>,
    ) -> Result<ListToolsResult, ErrorData> {
        let all = Tool::ALL.map(|tool| {
            let reads = ToolAnnotations::new().read_only(true).idempotent(true).open_world(false);
            rmcp::model::Tool::new(tool.name(), tool.about(), tool.schema()).with_annotations(reads)
        });
        Ok(ListToolsResult::with_all_items(all.to_vec()))
    }

    async fn call_tool(
        &self,
        request: CallToolRequestParams,
        _: RequestContext<RoleServer>,
    ) -> Result<CallToolResponse, ErrorData> {
        let Some(tool) = Tool::ALL.into_iter().find(|tool| tool.name() == request.name) else {
            let names = Tool::ALL.map(Tool::name).join(", ");
            let text = format!("there is no tool {:?}; there are: {names}", request.name);
            return Err(ErrorData::invalid_params(text, None));
        };
        let (reply, answer) = oneshot::channel();
        let call = Call { tool, arguments: request.arguments.unwrap_or_default(), reply };
        let ends = |_| ErrorData::internal_error("the program ends", None);
        self.calls.send(call).map_err(|_| ends(()))?;
        Ok(result(answer.await.map_err(|_| ends(()))?).into())
    }
}

/// An answer as the protocol has it.
fn result(reply: Reply) -> CallToolResult {
    match reply {
        Err(text) => CallToolResult::error(vec![ContentBlock::text(text)]),
        Ok(Answer { json, png: None }) => CallToolResult::structured(json),
        Ok(Answer { json, png: Some(png) }) => {
            let mut result = CallToolResult::structured(json);
            let picture = ContentBlock::image(BASE64_STANDARD.encode(png), "image/png");
            result.content.insert(0, picture);
            result
        }
    }
}
