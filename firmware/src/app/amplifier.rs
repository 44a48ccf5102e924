//! The application for a board whose torque output has an amplifier of its own: the tick's timer, the serial line and
//! the desk.

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use firmware::board::{AngleCounter, SerialOutput, TickClock, TorqueOutput};
    use firmware::desk::{Desk, Identity};
    use firmware::settings::{self, BoardKind};
    use firmware::store::Keep;
    use firmware::ticker::Ticker;
    use firmware::{Commands, Link, Moves, Records};
    use heapless::spsc::{Consumer, Producer, Queue};
    use protocol::ResetReason;
    use stm32f4xx_hal::pac::Interrupt;

    use crate::board::{self, Board, Clock, Encoder, Rest, SerialIn, SerialOut, Storage, Torque};

    /// Bytes from the host that the desk has not read yet.
    type Bytes = Queue<u8, BYTES>;
    const BYTES: usize = 512;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        rest: Rest,
        clock: Clock,
        encoder: Encoder,
        torque: Torque,
        ticker: Ticker<'static>,
        serial_in: SerialIn,
        received: Producer<'static, u8, BYTES>,
        bytes: Consumer<'static, u8, BYTES>,
        serial_out: SerialOut,
        desk: Desk<'static, Storage>,
    }

    #[init(local = [
        byte_queue: Bytes = Queue::new(),
        commands: Commands = Queue::new(),
        records: Records = Queue::new(),
        moves: Moves = Queue::new(),
        link: Link = Link::new(),
    ])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let Board {
            mut clock,
            mut encoder,
            torque,
            serial_in,
            serial_out,
            mut storage,
            rest,
        } = board::set_up(cx.device);
        let link: &'static Link = cx.local.link;
        let (received, bytes) = cx.local.byte_queue.split();
        let (command_sender, command_receiver) = cx.local.commands.split();
        let (record_sender, record_receiver) = cx.local.records.split();
        let (move_sender, move_receiver) = cx.local.moves.split();
        let identity = Identity {
            firmware: env!("CARGO_PKG_VERSION"),
            git_hash: env!("GIT_HASH"),
            board: board::NAME,
            kind: BoardKind::Amplifier {
                counter_bits: Encoder::BITS,
            },
            reset: ResetReason::Unknown,
        };
        // The defaults are tested natively to settle; a board that cannot run them must not run.
        let Ok(start) = settings::start(&storage.load(), &identity.kind) else {
            panic!("the default parameters are refused");
        };
        clock.set_period_s(start.settings.parameters.sample_period_s);
        let ticker = Ticker::new(
            &start.settled,
            encoder.counter(),
            link,
            command_receiver,
            record_sender,
            move_sender,
        );
        let desk = Desk::new(
            identity,
            &start,
            storage,
            link,
            command_sender,
            record_receiver,
            move_receiver,
        );
        defmt::info!(
            "knob {=str} ({=str}) on {=str}",
            identity.firmware,
            identity.git_hash,
            identity.board
        );
        (
            Shared {},
            Local {
                rest,
                clock,
                encoder,
                torque,
                ticker,
                serial_in,
                received,
                bytes,
                serial_out,
                desk,
            },
        )
    }

    /// Everything sleeps.
    #[idle(local = [rest])]
    fn idle(cx: idle::Context) -> ! {
        loop {
            cx.local.rest.rest();
        }
    }

    /// The tick: read the encoder, decide, write the torque. Highest priority; waits for nothing.
    #[task(binds = TIM2, priority = 4, local = [clock, encoder, torque, ticker])]
    fn tick(cx: tick::Context) {
        let start = board::stopwatch();
        let overran = cx.local.clock.acknowledge();
        let elapsed_s = cx.local.clock.elapsed_s();
        let counter = cx.local.encoder.counter();
        let output = cx.local.ticker.tick(counter, elapsed_s, overran);
        cx.local.torque.set_nm(output.torque_nm);
        if let Some(period_s) = output.period_s {
            cx.local.clock.set_period_s(period_s);
        }
        rtic::pend(Interrupt::EXTI0);
        board::tick_cost(start);
    }

    /// One byte from the host.
    #[task(binds = USART1, priority = 3, local = [serial_in, received])]
    fn receive(cx: receive::Context) {
        if let Some(byte) = cx.local.serial_in.read() {
            // Where there is no room the byte is lost, the frame's checksum fails, and the host
            // asks again.
            let _ = cx.local.received.enqueue(byte);
            rtic::pend(Interrupt::EXTI0);
        }
    }

    /// Everything slow: answers the host, sends what the tick has told.
    #[task(binds = EXTI0, priority = 1, local = [bytes, serial_out, desk])]
    fn desk(cx: desk::Context) {
        let (bytes, out) = (cx.local.bytes, cx.local.serial_out);
        cx.local
            .desk
            .serve(|| bytes.dequeue(), |frame| out.write(frame));
    }
}
